%%%
  VERSION:1
  LANGUAGE:ENGLISH
%%%

MODULE PROG1
  VAR num reg1:=0;
  PROC main()
    MoveJ pStart,v100,fine,tGrip;
    MoveL [[355.0679,-26.4309,31.6213],[0.12472468,-0.391612558,-0.877133633,-0.248435],[0,0,0,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]],v100,fine,tPen\WObj:=wTable;
    MoveL pEnd,v100,fine,tPen\WObj:=wTable;
    rOther;
  ENDPROC
ENDMODULE

MODULE PROG2
  PROC rOther()
    MoveAbsJ [[-20,30,5,-10,50,-35],[9E9,9E9,9E9,9E9,9E9,9E9]],v100,fine,tNowhere;
  ENDPROC
ENDMODULE
